"""Runs as files for others: tables, ParaView, AnnData, netCDF, OpenVT, RO-Crate."""

from multicell.report.exports.files import FORMATS, export
from multicell.report.tables import TABLES

__all__ = ["FORMATS", "TABLES", "export"]
