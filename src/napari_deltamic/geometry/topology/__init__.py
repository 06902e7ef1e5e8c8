"""Where surfaces cross or run thin, and how regions come to touch, part or divide."""
