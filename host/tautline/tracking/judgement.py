"""The judgement of hypotheses, spread over frames: so much work in each, and what came of the last ones."""

from __future__ import annotations

from tautline.tracking.fit import Work
from tautline.tracking.hypotheses import Inference

_FRAME_WORK = 360  # limit: us, about, of work in one frame; no piece of it costs more
_FORETELLS = 2  # loss: strokes that a proposal is tried on before another replaces it
_NEWS = 10  # tolerance: frames between two judgements
_UNEXPLAINED = 3  # loss: strokes without a law that explains them, after which what was learnt is given up


class Judgement:
    """`proposal` is a law that is to foretell the strokes to come. Work is counted, not timed, so that a replay repeats
    bit for bit."""

    def __init__(self) -> None:
        """None is at work, and nothing is proposed."""
        self.proposal: Inference | None = None
        self._work: Work[Inference] | None = None
        self._next_cost_us = 0  # what its next piece costs, us
        self._news = 0  # frames since the last one began
        self._stuck, self._stuck_in = 0, -1  # strokes without a law that explains them, and the last of them

    def add_frame(self) -> None:
        """A frame more is evidence."""
        self._news += 1

    def hurry(self) -> None:
        """The next one begins at once, without what the ones before proposed."""
        self._news, self._stuck, self.proposal = _NEWS, 0, None

    def drop(self) -> None:
        """Ends the one that is at work, and forgets what was proposed."""
        self._work, self.proposal = None, None

    @property
    def may_begin(self) -> bool:
        """Whether one may begin: none is at work, and enough frames came."""
        return self._work is None and self._news >= _NEWS

    def begin(self, work: Work[Inference] | None) -> None:
        """Begins one of the frames so far; None: they are too few for any."""
        self._work, self._next_cost_us, self._news = work, 0, 0

    def advance(self) -> Inference | None:
        """Does a frame's share of the work; the verdict once it is done. None before, and where there is no work."""
        if self._work is None:
            return None
        try:
            spent = 0
            while spent == 0 or spent + self._next_cost_us <= _FRAME_WORK:
                spent += self._next_cost_us
                self._next_cost_us = next(self._work)
        except StopIteration as end:
            self._work = None
            verdict: Inference = end.value
            return verdict
        return None

    def keep_proposal(self, verdict: Inference, stroke: int) -> None:
        """What this verdict proposes replaces none, or a proposal that was tried on more than _FORETELLS strokes since
        the evidence that it was made of. stroke: the number of the one that is under way."""
        if self.proposal is None or stroke > self.proposal.evidence.stroke[-1] + _FORETELLS:
            self.proposal = verdict.proposal

    def note_explained(self) -> None:
        """A law explained the evidence."""
        self._stuck = 0

    def note_unexplained(self, stroke: int) -> bool:
        """No law explained the evidence in this stroke; whether that is so often that what was learnt is given up."""
        self._stuck += self._stuck_in != stroke
        self._stuck_in = stroke
        given_up = self._stuck >= _UNEXPLAINED
        if given_up:
            self._stuck = 0
        return given_up
