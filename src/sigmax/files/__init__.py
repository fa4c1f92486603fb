"""Files as they are written: tables, units, the TOML that describes them, functions of the user."""
