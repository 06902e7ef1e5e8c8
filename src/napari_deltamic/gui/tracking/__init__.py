"""Tracking in the widget: the panel, the thread, the layers."""
