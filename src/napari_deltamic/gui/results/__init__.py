"""What was found: the table, selection, files, sessions, the command that repeats it."""
