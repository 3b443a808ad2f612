"""Our worlds behind the interfaces of other libraries, a file for each."""
