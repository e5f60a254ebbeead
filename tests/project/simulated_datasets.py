"""A simulation of given datasets, in parts of one dataset each."""

from kennfeld.project.simulation import SimulatedPart


class SimulatedDatasets:
    def __init__(self, *datasets):
        self.datasets = datasets
        self.units = {channel.name: channel.unit for data in reversed(datasets) for channel in data.channels}
        self.files = {}
        self.samples = {data.name: data.samples for data in datasets}

    def parts(self):
        return [SimulatedPart(data, 0) for data in self.datasets]
