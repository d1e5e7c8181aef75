"""What the package asks of the machine: files, memory, signals, settings, other packages."""
