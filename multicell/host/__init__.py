"""The machine: files, memory, signals, settings, other packages."""
