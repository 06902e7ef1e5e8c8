"""Seeds: where they come from, how they are checked, previewed and drawn."""
