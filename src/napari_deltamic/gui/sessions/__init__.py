"""The window as a file, and a file in the window."""
