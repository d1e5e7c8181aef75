"""Reactions between fields: kinetics, and solving for the fields together."""
