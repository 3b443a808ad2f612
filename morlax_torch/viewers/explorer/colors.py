"""Colors of drawings that are readable on light and on dark pages."""

GRAY, INK = "#9aa3ad", "currentColor"
