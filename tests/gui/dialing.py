"""What the tests of the accuracy dial share."""


def settled(widget):
    seeds = widget.seeds
    return lambda: (
        not (seeds._later.isActive() or seeds.preview.busy or widget.settings.forecast.busy)
    )


def running(widget):
    return widget.doc.run is not None and widget.doc.run.running
