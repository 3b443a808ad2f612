"""A static page on which trained policies walk in any browser, without a server or Python."""
