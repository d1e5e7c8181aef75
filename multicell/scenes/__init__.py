"""The built-in scenes, one TOML file each."""
