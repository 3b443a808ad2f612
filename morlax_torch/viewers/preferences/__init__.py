"""Find out what a user wants from answers to "A or B?"."""
