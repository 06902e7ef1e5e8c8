"""A run: what is fitted to what, and how; the same for the command line and the window."""
