"""The terminal: reading command lines, showing progress, handling Ctrl-C."""
