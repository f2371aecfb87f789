"""Recordings out of other programs' files: open -> scan -> propose -> assemble -> save."""

from tautline.io.importing.assemble import Roles
from tautline.io.importing.importer import Imported, import_episodes, open_source, proposed_command, told
from tautline.io.importing.listing import Channel, Listing, scan
from tautline.io.importing.propose import Proposal, propose
from tautline.io.importing.source import Source

__all__ = [
    "Channel", "Imported", "Listing", "Proposal", "Roles", "Source", "import_episodes", "open_source", "propose",
    "proposed_command", "scan", "told",
]  # fmt: skip
