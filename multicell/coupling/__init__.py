"""The parts that a coupling step joins: time, motion, fields, and what the loop costs."""
