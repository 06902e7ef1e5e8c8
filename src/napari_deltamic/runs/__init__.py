"""What a run is: its settings, which ``run.toml`` holds, flags give and forms show."""
