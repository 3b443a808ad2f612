"""The page of `morlax explore`: a session that needs no browser, and its widgets."""
