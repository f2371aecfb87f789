"""Recordings out of other programs' files: open -> scan -> propose -> assemble -> save."""

from tautline.io.importing.assemble import Roles
from tautline.io.importing.importer import Imported, import_episodes, named_roles, open_source, proposed_command
from tautline.io.importing.listing import Channel, Listing, scan
from tautline.io.importing.propose import Proposal, propose
from tautline.io.importing.source import Source

__all__ = [
    "Channel",
    "Imported",
    "Listing",
    "Proposal",
    "Roles",
    "Source",
    "import_episodes",
    "named_roles",
    "open_source",
    "propose",
    "proposed_command",
    "scan",
]  # fmt: skip
