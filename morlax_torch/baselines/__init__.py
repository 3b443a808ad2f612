"""PG-MORL, a package that is found by its name and imported when asked for."""
