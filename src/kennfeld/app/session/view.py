"""A project that could be read, at the present values."""

from collections.abc import Mapping, Sequence
from functools import cached_property

from kennfeld.app.session.edited_values import with_edits
from kennfeld.app.session.evidence import Evidence
from kennfeld.app.session.live_model import LiveDataset, LiveModel
from kennfeld.app.session.signals import GridPoint, ReadChannels, Signals
from kennfeld.base.arrays import Bool, Float, Int
from kennfeld.base.errors import Finding
from kennfeld.domain.parameters import Parameter
from kennfeld.optimize.quality.quality import Scorer
from kennfeld.optimize.quality.recording_sums import RecordingSums


class View:
    """A project that could be read, at the present values.

    Attributes:
        model: its compiled problem.
        start: the evaluation at the initial values.
        now: the evaluation at the present values.
        signals: what can be drawn.
        samples: number of training samples at each grid point, by table.
    """

    def __init__(self, model: LiveModel, read_channels: ReadChannels | None = None) -> None:
        self.model = model
        self.start = self.now = model.evaluate(model.problem.parameters)
        self.signals = Signals(model, self.start, read_channels, self._informed)
        self.samples: Mapping[str, Int] = self.evidence.sample_counts()

    @cached_property
    def evidence(self) -> Evidence:
        """The lookups at the present values, or at earlier ones with the same places."""
        return Evidence(self.model, self.now.parameters)

    @cached_property
    def file_sums(self) -> Sequence[RecordingSums]:
        """The errors over the files of each dataset at the initial and at the present values, as a run sums them."""
        sums = Scorer(self.model.problem).sums(self.start.parameters, self.now.parameters)
        for each in sums:
            each.recordings.close()
        return [each.recordings for each in sums]

    def _informed(self, recording: LiveDataset, point: GridPoint) -> Bool:
        """Mark the samples of a dataset whose lookup gives a value of a table a weight."""
        return self.evidence.informed(recording, point.parameter, point.value) > 0

    def follow(self, values: Mapping[str, Float], tables: Mapping[str, Parameter]) -> tuple[Finding, ...]:
        """Evaluate the model with edited values, and the initial ones of the other parameters; see `with_edits`."""
        initial = self.model.problem.parameters
        before = self.now.parameters
        parameters, findings = with_edits(initial, values, tables)
        self.now = self.start if parameters is initial else self.model.evaluate(parameters)
        self.signals.follow(self.now)
        # cached properties at the values before
        self.__dict__.pop("file_sums", None)
        # lookups and their counts depend on few of the values, and take longer than the function itself
        if self.model.moves_lookups(before, parameters):
            self.__dict__.pop("evidence", None)
            self.samples = self.evidence.sample_counts()
        return findings
