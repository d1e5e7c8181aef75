"""Colours of states and types, for all who draw; nothing that draws is loaded with them."""

from __future__ import annotations

from typing import Final

STATE_COLOURS: Final = {
    "proliferating": "#2a9d6a",
    "quiescent": "#f2b63c",
    "necrotic": "#4b3a5e",
    "apoptotic": "#200008",
}
# blue and orange first: they differ in lightness and for any colour vision (Okabe & Ito)
TYPE_COLOURS: Final = ("#0072b2", "#e69f00", "#7fd0a8", "#cc79a7", "#56b4e9", "#a04000", "#b8b000")
