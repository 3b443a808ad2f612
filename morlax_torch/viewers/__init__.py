"""Ways to look at a robot: live in the browser, or in a film."""
