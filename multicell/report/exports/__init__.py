"""Runs as files for others: tables, ParaView, AnnData, netCDF, OpenVT, RO-Crate."""
