"""Run a command in a process: streams, exit codes, messages of errors.

A command ends with one of :class:`multicell.errors.ExitCode` and at most one line about
what went wrong, whatever the streams are: of a narrow encoding, full, closed, or a pipe that nobody
reads any more. Only ``MULTICELL_DEBUG=1`` shows tracebacks.
"""

from __future__ import annotations

import io
import json
import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from importlib import import_module
from typing import IO, Any, ClassVar, Final, NoReturn, final

import click

from multicell.errors import ExitCode, MulticellError, UnitWarning, exit_code_of, is_set, printable
from multicell.host.interrupts import end_command, interrupted
from multicell.plugins.named import own_fault
from multicell.schema import specs


def print_json(document: Any) -> None:
    """Print one JSON document."""
    from multicell.results.folder import to_json

    text = to_json(document)
    try:
        text.encode(getattr(sys.stdout, "encoding", None) or "utf-8")
    except UnicodeEncodeError:
        # escaped it is the same text
        text = json.dumps(json.loads(text), indent=2)
    # click's own choice of a stream would be UTF-8 where this one is ASCII
    click.echo(text, file=sys.stdout)


def print_result(as_json: bool, document: Any, *lines: object) -> None:
    """Print a result: as one JSON document, or in lines."""
    if as_json:
        print_json(document)
    else:
        for line in lines:
            click.echo(line, file=sys.stdout)


_NUMBERS: Final = {
    r"is not a valid integer( range)?": "must be a whole number",
    r"is not a valid float( range)?": "must be a number",
    r"is not in the range x>=(\S+)\.": r"must be at least \1.",
    r"is not in the range (\S+)<=x<=(\S+)\.": r"must be from \1 to \2.",
}
"""What click says of a number -> what is said here."""
_OTHER_OPTIONS: Final = {"--vary": "--free", "--free": "--vary", "--out": "--output"}
"""Options of one command that people write for another."""
_OUTPUTS: Final = {"plot": "section.png", "movie": "movie.gif", "export": "tables"}
"""What is written, by commands that write no run, as an example."""
_MEANT: Final = {
    "version": "--version",
    "workprecision": "compare SCENE -o out",
    "simulate": "run SCENE -o out",
    "check": "explain SCENE",
    "keys": "schema",
    "gui": "play SCENE",
    "list": "scenes",
    "new": "init NAME",
    "validate": "explain SCENE",
    "animate": "movie out -o movie.gif",
}
"""Words that stand for commands -> the arguments to write."""
DEBUG = "MULTICELL_DEBUG"  # environment variable that shows the traceback of an unexpected error


class Group(click.Group):
    """A group of commands that knows what people type in their place.

    - ``meant``, word -> arguments to write; ``scene``: those for a scene, with ``{}`` for its name
    """

    meant: ClassVar[Mapping[str, str]] = {}
    scene = "run {} -o out"

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that is asked for; refuse others with the one that was meant."""
        name = args[0]
        if self.get_command(ctx, name) is None:
            above = [] if ctx.parent is None else [ctx.info_name or ""]
            meant = {**self.meant, "help": " ".join([*above, *args[1:2], "--help"])}.get(name)
            if meant is None:
                from multicell.cli.options import known_scenes

                if name.endswith(".toml") or name in known_scenes():
                    meant = self.scene.format(name)
            if meant is not None:
                raise click.UsageError(f"No such command {name!r}: multicell {meant}.", ctx)
        return super().resolve_command(ctx, args)


@final
class Commands(Group):
    """The group of all commands, which ends the process in words.

    - ``elsewhere``, name -> ``module:function``: commands whose modules are loaded with them
    - ``tasks``, heading -> names of commands, as the help lists them
    """

    meant = _MEANT

    def __init__(
        self,
        *arguments: Any,
        elsewhere: Mapping[str, str],
        tasks: Mapping[str, Sequence[str]],
        **options: Any,
    ) -> None:
        super().__init__(*arguments, **options)
        self._tasks = tasks
        self._elsewhere = elsewhere

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands."""
        return sorted({*self.commands, *self._elsewhere})

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """List the commands by what they are for, each with a whole sentence."""
        named = {name for names in self._tasks.values() for name in names}
        others = [name for name in self.list_commands(ctx) if name not in named]
        for task, names in {**self._tasks, "Other commands": others}.items():
            if rows := [(name, _sentence(self.get_command(ctx, name))) for name in names]:
                with formatter.section(task):
                    formatter.write_dl(rows)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command; None if there is no such one."""
        if cmd_name in self._elsewhere and cmd_name not in self.commands:
            module, function = self._elsewhere[cmd_name].split(":")
            self.add_command(getattr(import_module(f"multicell.cli.{module}"), function))
        return super().get_command(ctx, cmd_name)

    def main(
        self,
        args: Sequence[str] | None = None,
        prog_name: str | None = None,
        complete_var: str | None = None,
        standalone_mode: bool = True,
        **extra: Any,
    ) -> Any:
        """Run a command; by default end the process with its exit code."""
        if not standalone_mode:
            return super().main(args, prog_name, complete_var, False, **extra)
        given = list(sys.argv[1:] if args is None else args)

        def command() -> Any:
            return super(Commands, self).main(given, prog_name, complete_var, False, **extra)

        with quiet_libraries() if {"--quiet", "-q"} & {*given} else nullcontext():
            leave(exit_code(command, "--json" in given))


def _sentence(command: click.Command | None) -> str:
    """Return the first sentence of a command's help."""
    text = " ".join(((command and command.help) or "").partition("\n\n")[0].split())
    return text.partition(". ")[0].rstrip(".") + "."


@contextmanager
def quiet_libraries() -> Iterator[None]:
    """Print no warnings of libraries, here and in processes that this one starts."""
    import logging

    before, disabled = os.environ.get("PYTHONWARNINGS"), logging.root.manager.disable
    os.environ["PYTHONWARNINGS"] = "ignore"
    logging.disable(logging.WARNING)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(disabled)
        if before is None:
            del os.environ["PYTHONWARNINGS"]
        else:
            os.environ["PYTHONWARNINGS"] = before


def exit_code(command: Callable[[], Any], as_json: bool) -> int:
    """Run a command; put what went wrong into one line; return the exit code."""
    _open_standard_streams()
    _fit_encodings()
    try:
        with _notes():
            code = command()
        if sys.stdout is not None:
            sys.stdout.flush()
        return code if isinstance(code, int) else 0
    except (KeyboardInterrupt, click.Abort):
        end_command()
        complain("Interrupted.")
        return ExitCode.INTERRUPTED
    except click.exceptions.Exit as leaving:
        return leaving.exit_code
    except SystemExit as leaving:  # click's, where who reads our output has gone
        return ExitCode.MACHINE if leaving.code == 1 else int(leaving.code or 0)
    except Exception as error:
        if interrupted() and not isinstance(error, MulticellError | OSError):
            # a Ctrl-C during the import of a library, or reported as another error
            complain("Interrupted.")
            return ExitCode.INTERRUPTED
        return _explain(error, as_json)


@contextmanager
def _notes() -> Iterator[None]:
    """Print values that were read without a unit as a line, and nothing with ``--quiet``."""
    with warnings.catch_warnings():
        before = warnings.showwarning

        def show(message: Any, category: type[Warning], *place: Any, **more: Any) -> None:
            context = click.get_current_context(silent=True)
            if not issubclass(category, UnitWarning):
                before(message, category, *place, **more)
            elif context is None or not context.params.get("quiet"):
                complain(f"Note: {message}")

        warnings.showwarning = show
        yield


def _explain(error: Exception, as_json: bool) -> int:
    """Print one line (usage errors: click's) about an error; return its exit code."""
    if isinstance(error, BrokenPipeError):
        return ExitCode.MACHINE  # without words: who reads has gone
    if isinstance(error, click.ClickException):
        error = _with_hint(error)
        object.__setattr__(error, "message", printable(error.message, lines=True))
        with quietly():
            error.show(file=sys.stderr)
        message, code = error.format_message(), error.exit_code
    else:
        message, code = error_in_words(error)
        complain(f"Error: {message}")
        if is_set(DEBUG) and not isinstance(error, MulticellError):
            import traceback

            complain("".join(traceback.format_exception(error)).rstrip())
    unwritable = isinstance(error, OSError) and error.filename is None
    if as_json and not unwritable:
        with quietly():
            print_json({"error": message, "kind": type(error).__name__})
    return code


def _with_hint(error: click.ClickException) -> click.ClickException:
    """Return a complaint about a further argument with what that was most likely meant to be."""
    if isinstance(error, click.NoSuchOption):
        return _with_key(error)
    if isinstance(error, click.MissingParameter):
        return _with_example(error)
    if isinstance(error, click.BadParameter):
        said = error.message
        for pattern, words in _NUMBERS.items():
            said = re.sub(pattern, words, said)
        if said == error.message:  # such as an option that is missing, which is another kind
            return error
        return click.BadParameter(said, error.ctx, error.param, error.param_hint)
    found = re.search(r"unexpected extra arguments? \((.*)\)", error.message)
    if found is None or not isinstance(error, click.UsageError):
        return error
    option = next((text for text in reversed(sys.argv) if text.startswith("--")), "--set")
    known = [name for entry in error.ctx.command.params for name in entry.opts] if error.ctx else []
    short = [text for text in sys.argv if re.fullmatch(r"-[a-z]{2,}", text)]
    long = [name for text in short for name in known if name.startswith(f"-{text}")]
    first = found[1].split()[0]
    place = sys.argv.index(first) if first in sys.argv else 0
    hint = f"a value with a space stands in quotes, as '… {found[1]}'"
    if long:
        hint = f"an option of several letters has two hyphens: {long[0]}"
    elif place < 2 or not sys.argv[place - 2].startswith("-"):
        return error  # what stands before it is no value of an option
    if "=" in found[1]:
        each = " ".join(f"{option} {text}" for text in found[1].split())
        hint = f"each KEY=VALUE has an option of its own: {each}"
    return click.UsageError(f"{error.message.rstrip('.')}: {hint}.", error.ctx)


def _with_example(error: click.MissingParameter) -> click.ClickException:
    """Return a complaint about a missing option with an example of it."""
    option = error.param
    if not isinstance(option, click.Option):
        return error
    short = min(option.opts, key=len)
    command = error.ctx.command.name if error.ctx is not None else ""
    value = option.metavar or "…"
    if option.name == "output":
        value = _OUTPUTS.get(command or "", "out")
    named = " / ".join(repr(name) for name in option.opts)
    return click.UsageError(f"Missing option {named}, for example {short} {value}.", error.ctx)


def _with_key(error: click.NoSuchOption) -> click.ClickException:
    """Return a complaint about an option with the key of scenes that has its name."""
    there = [name for entry in error.ctx.command.params for name in entry.opts] if error.ctx else []
    other = _OTHER_OPTIONS.get(error.option_name)
    if other in there:
        return click.UsageError(f"No such option: {error.option_name}. Write {other}.", error.ctx)
    word = error.option_name.lstrip("-").replace("-", "_")
    takes_changes = error.ctx is not None and any(
        parameter.name == "changes" for parameter in error.ctx.command.params
    )
    if not takes_changes:
        return error
    from multicell.scene.scene import Scene

    tables = {name: spec.table for name, spec in specs(Scene).items() if spec.table is not None}
    keys = [word] if word in specs(Scene) else []
    named = {name for name, spec in specs(Scene).items() if spec.kind == "tables"}
    for name in sorted(tables, key=lambda name: name in named):
        if word in specs(tables[name]):
            keys.append(f"{name}.NAME.{word}" if name in named else f"{name}.{word}")
    if not keys:
        return error
    said = f"No such option: {error.option_name}. It is a key of the scene: --set {keys[0]}='…'"
    return click.UsageError(said, error.ctx)


def error_in_words(error: Exception) -> tuple[str, int]:
    """Return one line about an error, and its exit code."""
    if isinstance(error, MulticellError):
        return str(error), exit_code_of(error)
    if isinstance(error, OSError):
        reason = error.strerror or str(error) or type(error).__name__
        if error.filename is None:
            return f"the output cannot be written: {reason}", ExitCode.MACHINE
        return f"'{error.filename}' cannot be used: {reason}", exit_code_of(error)
    if isinstance(error, MemoryError):
        return "there is not enough memory for this", ExitCode.MACHINE
    fault = own_fault(error)
    if fault is not None:
        words = f"your own code fails: {fault}. {DEBUG}=1 shows how it was called"
        return words, ExitCode.FAILED
    said = " ".join(str(error).split())
    if "no locator available" in said:  # numba's words
        return (
            "compiled code cannot be kept: neither the folder of multicell nor the home folder can "
            "be written to. Set NUMBA_CACHE_DIR to a folder of your own",
            ExitCode.MACHINE,
        )
    return (
        f"unexpected {type(error).__name__}{f': {said}' if said else ''}. This is a bug of "
        f"multicell; {DEBUG}=1 shows where it happened, which a report of it should contain",
        ExitCode.BUG,
    )


def complain(text: str) -> None:
    """Print a line on stderr, where that can be written to."""
    with quietly():
        click.echo(printable(text, lines=True), file=sys.stderr, err=True)


def leave(code: int) -> NoReturn:
    """End the process; what a broken stream still holds must not speak last."""
    end_command()
    for stream, number in ((sys.stdout, 1), (sys.stderr, 2)):
        try:
            if stream is not None:
                stream.flush()
        except (OSError, ValueError):
            _silence(stream, number)
            code = code or ExitCode.MACHINE
    sys.exit(code)


@final
class Faltering:
    """A stream that says nothing where it cannot be written to.

    Progress must not end a run because the terminal has gone or a log's disk is full.
    """

    def __init__(self, stream: IO[str] | None) -> None:
        self._stream = io.StringIO() if stream is None else stream

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write, or not."""
        with quietly():
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, or not."""
        with quietly():
            self._stream.flush()


@contextmanager
def quietly() -> Iterator[None]:
    """Continue where a stream cannot be written to; the exit code reports it."""
    try:
        yield
    except (OSError, ValueError):
        return


def _fit_encodings() -> None:
    """Let the standard streams print ``?`` for what their encoding lacks, in place of failing."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            with quietly():
                stream.reconfigure(errors="replace")


def _open_standard_streams() -> None:
    """Open the null device where a standard stream is closed.

    The next file that is opened would get its number, and with it what C libraries print.
    """
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)


def _silence(stream: Any, number: int) -> None:
    """Send what is left in a broken stream nowhere."""
    try:
        if stream.fileno() == number:
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, number)
            os.close(null)
    except (OSError, ValueError, AttributeError):
        return
