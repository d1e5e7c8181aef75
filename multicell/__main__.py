"""``python -m multicell`` does the same as the command ``multicell``."""

from multicell.cli import main

if __name__ == "__main__":
    main(prog_name="multicell")
