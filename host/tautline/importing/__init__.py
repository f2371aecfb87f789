"""Recordings out of other programs' files: open -> scan -> propose -> assemble -> save."""

from tautline.importing.assemble import Roles
from tautline.importing.importer import Imported, import_episodes, open_source, proposed_command, told
from tautline.importing.listing import Channel, Listing, scan
from tautline.importing.propose import Proposal, propose
from tautline.importing.source import Source

__all__ = [
    "Channel", "Imported", "Listing", "Proposal", "Roles", "Source", "import_episodes", "open_source", "propose",
    "proposed_command", "scan", "told",
]  # fmt: skip
