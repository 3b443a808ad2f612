"""PG-MORL and PD-MORL, each a package that is found by its name and imported when asked for."""
