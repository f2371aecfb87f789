"""One judgement of hypotheses at a time, its work spread over frames; and what came of the last judgements."""

from __future__ import annotations

from tautline.tracking.fit import Work
from tautline.tracking.hypotheses import Inference

_FRAME_WORK = 360  # limit: us, about, of work in one frame; no piece of it costs more
_FORETELLS = 2  # loss: strokes that a proposal is tried on before another replaces it
_NEWS = 10  # tolerance: frames between two judgements
_UNEXPLAINED = 3  # loss: strokes without a law that explains them, after which what was learnt is given up


class Judgement:
    """Does a judgement's work in pieces, some of them in each frame. `proposal` is a verdict whose law is to foretell
    the strokes to come. Work is counted by its stated cost, not timed, so that a replay repeats bit for bit."""

    def __init__(self) -> None:
        """Begins with no judgement at work and no proposal."""
        self.proposal: Inference | None = None
        self._work: Work[Inference] | None = None
        self._next_cost_us = 0  # of the next piece of work
        self._news = 0  # frames since the last judgement began
        self._stuck, self._stuck_in = 0, -1  # strokes without a law that explains them, and the last of them

    def add_frame(self) -> None:
        """Counts a frame that was added to the evidence."""
        self._news += 1

    def hurry(self) -> None:
        """Lets the next judgement begin at once, without the present proposal, and counts strokes without a law
        anew."""
        self._news, self._stuck, self.proposal = _NEWS, 0, None

    def drop(self) -> None:
        """Ends the judgement that is at work, and forgets the proposal."""
        self._work, self.proposal = None, None

    @property
    def may_begin(self) -> bool:
        """Whether a judgement may begin: none is at work, and _NEWS frames were added since the last one began."""
        return self._work is None and self._news >= _NEWS

    def begin(self, work: Work[Inference] | None) -> None:
        """Sets the work of a new judgement, which `advance` does. None: the evidence is too little for a judgement, and
        the next one waits for _NEWS frames more."""
        self._work, self._next_cost_us, self._news = work, 0, 0

    def advance(self) -> Inference | None:
        """Does one frame's share of the work: pieces up to _FRAME_WORK us. Returns the verdict with the last piece;
        None before, and where no judgement is at work."""
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
        """Takes what a verdict proposes (perhaps nothing) for the proposal, if there was none, or more than _FORETELLS
        strokes came since the evidence that the old one was made from. stroke: the present one's number."""
        if self.proposal is None or stroke > self.proposal.evidence.stroke[-1] + _FORETELLS:
            self.proposal = verdict.proposal

    def note_explained(self) -> None:
        """Notes that a law explained the evidence: strokes without one are counted anew."""
        self._stuck = 0

    def note_unexplained(self, stroke: int) -> bool:
        """Notes that no law explained the evidence in this stroke. Returns whether it is the _UNEXPLAINED-th such
        stroke, so that what was learnt is to be given up; the count begins anew then."""
        self._stuck += self._stuck_in != stroke
        self._stuck_in = stroke
        given_up = self._stuck >= _UNEXPLAINED
        if given_up:
            self._stuck = 0
        return given_up
