"""What the tests of the accuracy dial share."""


def settled(widget):
    later, forecast = widget.seeds._later, widget.settings.forecast.background
    return lambda: not (later.isActive() or widget.seeds.preview.background.busy or forecast.busy)


def running(widget):
    return widget.doc.run is not None and widget.doc.run.running
