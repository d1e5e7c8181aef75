"""CVODE with compiled callbacks: the libraries of scikit-sundae, called without its wrappers.

scikit-sundae makes arrays for each callback, which takes more time than the kernels do with up to
a thousand cells. Here CVODE calls compiled code: right-hand side, products with J, preconditioner.
What happens rarely (a new neighbour list, a new Jacobian, new blocks) stays in Python, on
:class:`Mechanics`. Steps have the same bits as those through scikit-sundae, which takes over where
its libraries are not found or :func:`suits` says no.

Compiled code finds the typed arguments of kernels in memory at an address that CVODE hands through
(:func:`_put`, :func:`_take`). A callback has the types that C gives it and one more argument, which
no caller gives and nobody reads: numba specialises the function on its type.
"""

from __future__ import annotations

import ctypes
import weakref
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
import sksundae
from llvmlite import ir
from numba import carray, njit, typeof, types
from numba.core import cgutils
from numba.extending import intrinsic

from multicell.cells import FloatArray
from multicell.compiling import INLINED, address_of, call_at
from multicell.integrators.restarts import StepImpossible
from multicell.integrators.stepping import _forces_at, largest_length
from multicell.mechanics import blocks, forces

if TYPE_CHECKING:
    from multicell.integrators.cvode import Cvode
    from multicell.integrators.restarts import Run

_CALLBACK: dict[str, Any] = {"cache": True, "error_model": "numpy", "no_cpython_wrapper": True}
_ROOM = 4096  # bytes for the arguments of a kernel
_MAJOR = 7  # version of SUNDIALS whose interface this is
_BDF, _ADAMS, _ONE_STEP, _RIGHT = 2, 1, 2, 2
(
    _FORCES_ARE, _PRODUCT_ARE, _CELLS, _REBUILD, _LINEARISE, _SETUP, _NUMBERS, _PREDICTED,
    _REFERENCE, _INVERSE, _MOVED, _POINTER_OF, _FRESH, _STALE, _EVALUATIONS, _PRODUCTS, _SOLVES,
    _NEWTON,
) = range(18)  # fmt: skip
"""Places in the integers of a session: addresses, flags, counts."""
_BEGIN, _OFFSET, _PREDICTED_AT, _GAMMA, _RATE, _FAR, _USED, _SMALL, _LATEST = range(9)
"""Places in its numbers: see :class:`~multicell.integrators.cvode_solver.Krylov`."""
_MILD, _STIFF = 3.0, 10.0


@cache
def libraries() -> dict[str, Any] | None:
    """Return SUNDIALS's functions by name, None where they are not as this file expects them."""
    folder = Path(sksundae.__file__).parent.parent / "scikit_sundae.libs"
    real, integer, place = ctypes.c_double, ctypes.c_int, ctypes.c_void_p
    wanted = {
        "core": {
            "SUNDIALSGetVersionNumber": (place, place, place, place, integer),
            "SUNContext_Create": (integer, place), "SUNContext_Free": (place,),
            "SUNContext_ClearErrHandlers": (place,), "SUNLinSolFree": (place,),
            "N_VDestroy": (place,), "N_VGetArrayPointer": (place,),
        },
        "nvecserial": {"N_VMake_Serial": (ctypes.c_long, place, place)},
        "sunlinsolspgmr": {"SUNLinSol_SPGMR": (place, integer, integer, place)},
        "cvode": {
            "CVodeCreate": (integer, place), "CVodeInit": (place, place, real, place),
            "CVodeSStolerances": (place, real, real), "CVodeSetUserData": (place, place),
            "CVodeSetLinearSolver": (place, place, place), "CVodeFree": (place,),
            "CVodeSetJacTimes": (place, place, place), "CVodeSetMaxStep": (place, real),
            "CVodeSetPreconditioner": (place, place, place), "CVodeSetInitStep": (place, real),
            "CVodeSetMaxNonlinIters": (place, integer), "CVodeSetMaxOrd": (place, integer),
            "CVodeSetStopTime": (place, real), "CVodeGetNumRhsEvals": (place, place),
            "CVode": (place, real, place, place, integer),
        },
    }  # fmt: skip
    makers = {"N_VMake_Serial", "SUNLinSol_SPGMR", "CVodeCreate", "N_VGetArrayPointer"}
    found: dict[str, Any] = {}
    try:
        for name, functions in wanted.items():
            (path,) = folder.glob(f"libsundials_{name}-*.so*")
            library = ctypes.CDLL(str(path))
            for function, arguments in functions.items():
                found[function] = getattr(library, function)
                found[function].argtypes = arguments
                found[function].restype = place if function in makers else integer
    except (OSError, ValueError, AttributeError):
        return None
    version, text = (ctypes.c_int * 3)(), ctypes.create_string_buffer(64)
    at = [ctypes.addressof(version) + 4 * k for k in range(3)]
    found["SUNDIALSGetVersionNumber"](*at, text, 64)
    return found if version[0] == _MAJOR else None


def suits(method: Cvode, run: Run) -> bool:
    """Return whether compiled callbacks do the same as those in Python.

    Not for parts of a scene that are evaluated in Python, shared kernels, replaced velocities (as
    by a deadline), and settings of the method that only studies use.
    """
    system = run.system
    parts = (system.walls, system.prescribed, system.compression)
    usual = (method.linear, method.preconditioner, method.refresh, method.side)
    return (
        usual == ("gmres", "blocks", "moved", "right")
        and all(part is None for part in parts)
        and max(system.friction) == 0.0
        and system._list_threads() == 1
        and "velocity" not in vars(system)
        and libraries() is not None
    )


@intrinsic
def _pointer(context: Any, address: Any) -> Any:
    """Return an address as a pointer."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        return builder.inttoptr(values[0], cgutils.voidptr_t)

    return types.voidptr(address), generate


def _calling(result: Any, *arguments: Any) -> Any:
    """Return what an intrinsic needs that calls a function of C at an address."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        given = [context.get_value_type(kind) for kind in arguments]
        kind = ir.FunctionType(context.get_value_type(result), given)
        return builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])

    return result(types.int64, *arguments), generate


@intrinsic
def _call_pointer_of(context: Any, address: Any, vector: Any) -> Any:
    """Call N_VGetArrayPointer."""
    return _calling(types.int64, types.int64)


@intrinsic
def _call_python(context: Any, address: Any, number: Any, place: Any) -> Any:
    """Call back into Python; not zero is a failure."""
    return _calling(types.int32, types.float64, types.int64)


@intrinsic
def _put(context: Any, address: Any, value: Any) -> Any:
    """Store a value in zeroed memory or in place of one of its type; memory owns its arrays."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        at = builder.inttoptr(values[0], values[1].type.as_pointer())
        before = builder.load(at)
        context.nrt.incref(builder, value, values[1])
        builder.store(values[1], at)
        context.nrt.decref(builder, value, before)
        return context.get_dummy_value()

    return types.void(address, value), generate


@intrinsic
def _take(context: Any, address: Any, witness: Any) -> Any:
    """Return what was stored; ``witness`` has its type."""
    kind = witness.instance_type

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        at = builder.inttoptr(values[0], context.get_value_type(kind).as_pointer())
        value = builder.load(at)
        context.nrt.incref(builder, kind, value)
        return value

    return kind(address, witness), generate


@intrinsic
def _drop(context: Any, address: Any, value: Any) -> Any:
    """Give back what was stored; ``value`` is one of its type."""

    def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
        at = builder.inttoptr(values[0], values[1].type.as_pointer())
        context.nrt.decref(builder, value, builder.load(at))
        return context.get_dummy_value()

    return types.void(address, value), generate


@intrinsic
def _products_at(
    context: Any, address, chunk, rows, pairs, normal, along, across, drag, vector, out
):  # fmt: skip
    """Call ``forces.products`` at an address."""
    return call_at(
        types.none, address, chunk, rows, pairs, normal, along, across, drag, vector, out
    )


@njit(cache=True)
def _store(address, value):
    _put(address, value)


@njit(cache=True)
def _release(address, value):
    _drop(address, value)


@njit(**INLINED)
def _state(user):
    """Return integers and numbers of a session."""
    whole = carray(_pointer(user), (_NEWTON + 1,), np.int64)
    return whole, carray(_pointer(whole[_NUMBERS]), (_LATEST + 1,), np.float64)


@njit(**INLINED)
def _rows(address, n):
    return carray(_pointer(address), (n, 3), np.float64)


@njit(**INLINED)
def _vector(whole, vector):
    """Return the memory of a vector of SUNDIALS, (n, 3)."""
    return _rows(_call_pointer_of(whole[_POINTER_OF], vector), whole[_CELLS])


@njit(**INLINED)
def _velocity(t, x, out, whole, number, witness):
    """Write velocities; return 0, or -1 if there are none."""
    whole[_EVALUATIONS] += 1
    number[_LATEST] = t
    # rounded as the scene's clock is
    elapsed = number[_BEGIN] + number[_OFFSET] + t - number[_BEGIN]
    at, cells, pairs, offsets, law, rows = _take(whole[_FORCES_ARE], witness)
    while _forces_at(at, cells, pairs, offsets, law, x, elapsed, True, rows, out):
        if _call_python(whole[_REBUILD], t, x.ctypes.data) != 0:
            return -1
        at, cells, pairs, offsets, law, rows = _take(whole[_FORCES_ARE], witness)
    return 0


@njit(**_CALLBACK)
def _right_hand_side(t, y, out, user, witness):
    whole, number = _state(user)
    x = _vector(whole, y)
    if t != number[_PREDICTED_AT]:
        number[_PREDICTED_AT] = t
        _rows(whole[_PREDICTED], whole[_CELLS])[:] = x
    return types.int32(_velocity(t, x, _vector(whole, out), whole, number, witness))


@njit(**_CALLBACK)
def _quotient(vector, out, t, y, slope, user, room, witness):
    """Write J v as a difference quotient."""
    whole, number = _state(user)
    x, v, product = _vector(whole, y), _vector(whole, vector), _vector(whole, out)
    before, moved = _vector(whole, slope), _rows(whole[_MOVED], whole[_CELLS])
    most = 0.0
    for i in range(whole[_CELLS]):
        for k in range(3):
            most = max(most, abs(v[i, k]))
    if most == 0.0:
        product[:] = 0.0
        return types.int32(0)
    share = number[_SMALL] / most
    for i in range(whole[_CELLS]):
        for k in range(3):
            moved[i, k] = x[i, k] + share * v[i, k]
    status = _velocity(t, moved, product, whole, number, witness)
    for i in range(whole[_CELLS]):
        for k in range(3):
            product[i, k] = (product[i, k] - before[i, k]) / share
    return types.int32(status)


@njit(**_CALLBACK)
def _product(vector, out, t, y, slope, user, room, witness):
    """Write J v."""
    whole, _ = _state(user)
    whole[_PRODUCTS] += 1
    at, chunk, rows, pairs, normal, along, across, drag = _take(whole[_PRODUCT_ARE], witness)
    v, product = _vector(whole, vector), _vector(whole, out)
    _products_at(at, chunk, rows, pairs, normal, along, across, drag, v, product)
    return types.int32(0)


@njit(**INLINED)
def _has_moved(whole, number, x):
    """Return whether some cell has moved too far for the last Jacobian."""
    far = number[_FAR] * max(1.0, _STIFF / max(number[_GAMMA] * number[_RATE], 1e-9))
    reference = _rows(whole[_REFERENCE], whole[_CELLS])
    for i in range(whole[_CELLS]):
        for k in range(3):
            if not abs(x[i, k] - reference[i, k]) <= far:
                return True
    return False


@njit(**_CALLBACK)
def _before_products(t, y, slope, user):
    whole, number = _state(user)
    whole[_NEWTON] += 1
    x = _vector(whole, y)
    if whole[_FRESH]:
        whole[_FRESH] = 0
    elif _has_moved(whole, number, x):
        return types.int32(_call_python(whole[_LINEARISE], t, x.ctypes.data))
    return types.int32(0)


@njit(**_CALLBACK)
def _set_up(t, y, slope, same, renewed, gamma, user):
    whole, number = _state(user)
    number[_GAMMA] = gamma
    x, new = _vector(whole, y), carray(_pointer(renewed), (1,), np.int32)
    new[0] = 0
    if same == 0 or _has_moved(whole, number, x):
        if _call_python(whole[_LINEARISE], t, x.ctypes.data) != 0:
            return types.int32(-1)
        whole[_FRESH], new[0] = 1, 1
    whole[_STALE] = 1
    return types.int32(0)


@njit(**_CALLBACK)
def _precondition(t, y, slope, right, out, gamma, delta, side, user):
    whole, number = _state(user)
    number[_USED] = gamma
    r, z = _vector(whole, right), _vector(whole, out)
    if gamma * number[_RATE] < _MILD:
        z[:] = r
        return types.int32(0)
    if whole[_STALE]:
        if _call_python(whole[_SETUP], gamma, 0) != 0:
            return types.int32(-1)
        whole[_STALE] = 0
    whole[_SOLVES] += 1
    inverse = carray(_pointer(whole[_INVERSE]), (whole[_CELLS], 6), np.float64)
    blocks.apply_blocks(inverse, r, z)
    return types.int32(0)


_INT, _REAL, _BIT = types.int64, types.float64, types.int32
_TIMES = (_INT, _INT, _REAL, _INT, _INT, _INT, _INT)


@cache
def _callback(function: Any, *arguments: Any) -> int:
    """Return the address of a function for C; compile it if need be."""
    function.compile(arguments)
    made = function.overloads[arguments]
    return int(made.library.get_pointer_to_function(made.fndesc.llvm_cfunc_wrapper_name))


Linearise = Callable[[float, FloatArray], tuple[Any, float]]
_PYTHON = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_double, ctypes.c_void_p)


@final
class Session:
    """A CVODE object from its start to the next restart.

    - ``linearise``: takes J at a time and flat positions; returns it and the order of magnitude of
      its largest rate. None for products by difference quotients and no preconditioner
    - ``krylov``: dimension of the Krylov space
    - ``first``, ``ceiling``: length of the first step and bound on all, s; zero for SUNDIALS's own
    - ``small``, ``far``: change of a coordinate in a difference quotient; how far cells may move
      before J is renewed (more where steps are mild), µm
    """

    def __init__(
        self, method: Cvode, run: Run, *, linearise: Linearise | None, krylov: int, first: float,
        ceiling: float, small: float, far: float,
    ) -> None:  # fmt: skip
        sundials = libraries()
        assert sundials is not None
        system, n = run.system, len(run.system)
        self.run, self.system, self._linearise = run, system, linearise
        self.sundials = sundials
        self._error: BaseException | None = None
        self._whole, self._number = np.zeros(_NEWTON + 1, np.int64), np.zeros(_LATEST + 1)
        self._position, self._predicted = np.array(run.position), np.array(run.position)
        self._reference, self._moved = np.full((n, 3), np.inf), np.empty((n, 3))
        self._time, self._calls = ctypes.c_double(), ctypes.c_long()
        self._memory = np.zeros((2, _ROOM), np.uint8)
        self._python = [
            _PYTHON(self._guarded(f)) for f in (self._rebuild, self._take_jacobian, self._set_up)
        ]
        whole, number = self._whole, self._number
        whole[[_FORCES_ARE, _PRODUCT_ARE]] = (
            self._memory[0].ctypes.data,
            self._memory[1].ctypes.data,
        )
        whole[_CELLS], whole[_STALE] = n, 1
        for k, function in zip((_REBUILD, _LINEARISE, _SETUP), self._python, strict=True):
            whole[k] = ctypes.cast(function, ctypes.c_void_p).value
        arrays = number, self._predicted, self._reference, system._inverse, self._moved
        for k, array in zip(
            (_NUMBERS, _PREDICTED, _REFERENCE, _INVERSE, _MOVED), arrays, strict=True
        ):
            whole[k] = array.ctypes.data
        pointer_of = ctypes.cast(sundials["N_VGetArrayPointer"], ctypes.c_void_p)
        whole[_POINTER_OF] = pointer_of.value
        number[[_BEGIN, _OFFSET, _GAMMA, _RATE, _FAR, _USED, _SMALL]] = (
            system.motion.begin, run.offset, np.inf, 1.0, far, np.inf, small
        )  # fmt: skip
        self._kinds: dict[int, Any] = {}
        self._seen = whole.copy()
        self._start(method, krylov, first, ceiling)

    def _start(self, method: Cvode, krylov: int, first: float, ceiling: float) -> None:
        run, system, sundials = self.run, self.system, self.sundials
        if system._pairs is None:
            system._rebuild(np.array(run.position))
        self._place_forces()
        context = ctypes.c_void_p()
        sundials["SUNContext_Create"](0, ctypes.byref(context))
        sundials["SUNContext_ClearErrHandlers"](context)
        where = self._position.ctypes.data
        self._vector = sundials["N_VMake_Serial"](self._position.size, where, context)
        formula = _BDF if method.formula == "BDF" else _ADAMS
        self._solver = sundials["CVodeCreate"](formula, context)
        side = 0 if self._linearise is None else _RIGHT
        linear = sundials["SUNLinSol_SPGMR"](self._vector, side, krylov, context)
        weakref.finalize(
            self, _free, sundials, context, self._vector, self._solver, linear, self._memory,
            self._kinds,
        )  # fmt: skip
        witness = types.TypeRef(typeof(self._kinds[_FORCES_ARE]))
        right = _callback(_right_hand_side, _REAL, _INT, _INT, _INT, witness)
        settings: list[tuple[Any, ...]] = [
            ("CVodeSetUserData", self._whole.ctypes.data),
            ("CVodeInit", right, 0.0, self._vector),
            ("CVodeSStolerances", run.share * method.rtol, run.share * method.atol),
            ("CVodeSetLinearSolver", linear, None),
        ]
        if self._linearise is None:
            product = _callback(_quotient, *_TIMES, witness)
            settings.append(("CVodeSetJacTimes", None, product))
        else:
            pairs = system._pair_data
            none = np.empty(0)
            self._place_products(pairs, np.empty((0, 3)), none, none)
            witness = types.TypeRef(typeof(self._kinds[_PRODUCT_ARE]))
            before = _callback(_before_products, _REAL, _INT, _INT, _INT)
            product = _callback(_product, *_TIMES, witness)
            set_up = _callback(_set_up, _REAL, _INT, _INT, _BIT, _INT, _REAL, _INT)
            solve = _callback(
                _precondition, _REAL, _INT, _INT, _INT, _INT, _REAL, _REAL, _BIT, _INT
            )
            settings += [
                ("CVodeSetPreconditioner", set_up, solve), ("CVodeSetJacTimes", before, product)
            ]  # fmt: skip
        settings += [
            ("CVodeSetMaxNonlinIters", method.newton), ("CVodeSetInitStep", first),
            ("CVodeSetMaxStep", ceiling), ("CVodeSetMaxOrd", method.max_order),
            ("CVodeSetStopTime", run.left),
        ]  # fmt: skip
        for name, *values in settings:
            flag = sundials[name](self._solver, *values)
            if flag != 0:
                raise RuntimeError(f"SUNDIALS: {name} returned {flag}")

    def advance(self) -> tuple[float, FloatArray, float, int]:
        """Take one step.

        Returns time on the session's clock, s, positions, the largest move of a cell from where it
        was predicted, µm, or NaN, and the number of evaluations that are no products so far.
        """
        sundials, number = self.sundials, self._number
        flag = sundials["CVode"](
            self._solver, self.run.left, self._vector, ctypes.byref(self._time), _ONE_STEP
        )
        new, self._seen = self._whole - self._seen, self._whole.copy()
        work = self.system.work
        work.evaluations += int(new[_EVALUATIONS])
        work.jacobian_products += int(new[_PRODUCTS])
        work.linear_iterations += int(new[_PRODUCTS])
        work.preconditioner_solves += int(new[_SOLVES])
        work.newton_iterations += int(new[_NEWTON])
        self.run.latest = float(number[_LATEST])
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        if flag < 0:
            raise StepImpossible(f"SUNDIALS: flag {flag}")
        time, off = self._time.value, float("nan")
        if time == number[_PREDICTED_AT]:
            off = float(largest_length(self._position - self._predicted))
        sundials["CVodeGetNumRhsEvals"](self._solver, ctypes.byref(self._calls))
        return time, self._position.copy(), off, self._calls.value

    @property
    def used(self) -> float:
        """Return the last γ, s; infinite where there was none."""
        return float(self._number[_USED])

    def _guarded(self, function: Any) -> Any:
        """Return a function that keeps what it raises, since C cannot pass it on."""
        # a reference of its own would keep the session, and with it SUNDIALS's memory, for long
        inner, own = weakref.WeakMethod(function), weakref.ref(self)

        def call(number: float, place: int) -> int:
            try:
                inner()(number, place)  # type: ignore[misc]
            except BaseException as error:
                own()._error = error  # type: ignore[union-attr]
                return -1
            return 0

        return call

    def _at(self, place: int) -> FloatArray:
        flat = (ctypes.c_double * self._position.size).from_address(place)
        return np.frombuffer(flat).reshape(-1, 3)

    def _rebuild(self, time: float, place: int) -> None:
        self.system._rebuild(self._at(place))
        self._place_forces()

    def _take_jacobian(self, time: float, place: int) -> None:
        before, position = self.system._pairs, self._at(place)
        assert self._linearise is not None
        self._linear, self._number[_RATE] = self._linearise(time, position)
        self._reference[:] = position
        if self.system._pairs is not before:
            self._place_forces()
        linear = self._linear
        self._place_products(linear.data, linear.normal, linear.along, linear.across)

    def _set_up(self, gamma: float, place: int) -> None:
        self.system.setup_preconditioner(gamma, self._linear)

    def _place_forces(self) -> None:
        system, place = self.system, np.empty((0, 3))
        cells, pairs, offsets = system._cells, system._pair_data, system._offsets.data
        law, rows = system._law, system._rows
        at = address_of(
            forces.forces, True, cells, pairs, offsets, law, place, 0.0, True, rows, place
        )
        self._place(_FORCES_ARE, (at, cells, pairs, offsets, law, rows))

    def _place_products(self, pairs: Any, normal: Any, along: Any, across: Any) -> None:
        system, place = self.system, np.empty((0, 3))
        given = (system.chunk, system._rows, pairs, normal, along, across, system.drag)
        at = address_of(forces.products, None, *given, place, place)
        self._place(_PRODUCT_ARE, (at, *given))

    def _place(self, which: int, values: tuple[Any, ...]) -> None:
        self._kinds[which] = values
        _store(self._memory[which].ctypes.data, values)


def _free(
    sundials: dict[str, Any], context: Any, vector: int, solver: int, linear: int, memory: Any,
    kinds: dict[int, Any],
) -> None:  # fmt: skip
    """Give back all that a session has taken."""
    sundials["CVodeFree"](ctypes.byref(ctypes.c_void_p(solver)))
    sundials["SUNLinSolFree"](linear)
    sundials["N_VDestroy"](vector)
    sundials["SUNContext_Free"](ctypes.byref(context))
    for which, values in kinds.items():
        _release(memory[which].ctypes.data, values)
