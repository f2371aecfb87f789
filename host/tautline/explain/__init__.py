"""Pages of all that a message may name, made from its definition: effects, reasons of a verdict, faults, what a board
refuses, keys of rig.toml, files, terms. `taut explain` prints them, and writes them as HTML."""

from tautline.explain.collect import find, link, of_effect, topics
from tautline.explain.topic import KINDS, Topic

__all__ = ["KINDS", "Topic", "find", "link", "of_effect", "topics"]
