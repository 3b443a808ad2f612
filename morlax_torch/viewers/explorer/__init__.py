"""The page of `morlax_torch.explore`: a session that needs no browser, and its widgets."""
