"""Runs as files for other programs: tables, ParaView, AnnData, netCDF, Simularium, OpenVT."""

from multicell.report.exports.files import FORMATS, export
from multicell.report.tables import TABLES

__all__ = ["FORMATS", "TABLES", "export"]
