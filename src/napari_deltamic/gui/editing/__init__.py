"""Changes by hand while a fit runs or after it: sculpting, pins, history, undo."""
