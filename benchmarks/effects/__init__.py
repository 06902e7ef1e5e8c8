"""Figures of optics and effects: what ``docs/effects.md`` shows."""
