"""What the machine gives: files, processes, memory, threads; phases of work."""
