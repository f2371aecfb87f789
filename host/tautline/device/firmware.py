"""New firmware for a board: update files, what they say of themselves, and whether a board may have them.

A file is one image or several, for each slot that it can be linked for one. An image is a page of 256 bytes, the frame
of tl_wire.h's `image` and then zeros, and its bytes. The board checks all of this again before it erases anything.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import monocypher

from tautline.device import wire
from tautline.errors import TautError

PAGE = 256  # format: bytes, of flash and of DFU
ANY_SLOT = 255  # format: an image that runs wherever it is
_FORMAT = 1  # format: `format` of tl_wire.h's image
_HEADER = 8  # format: bytes of a frame before its payload
_HASH = 32  # format: bytes of BLAKE2b-256

PROTOCOL = (wire.wire.MAJOR, wire.wire.MINOR)  # that the firmware of this clone speaks

_AXES_MOST = 4  # format: axes of an image whose port's name has no number behind it

Version = tuple[int, int, int]


@dataclass(frozen=True)
class Image:
    """Firmware for one slot."""

    page: bytes  # the signed page of 256 bytes before it
    content: bytes  # what runs
    fields: wire.Message  # tl_wire.h's `image` out of the page

    @property
    def version(self) -> Version:
        """Version of the firmware: major, minor, patch."""
        return version_of(self.fields.version)

    @property
    def port(self) -> str:
        """Its name in the page: of the firmware's port (the chip), and for fewer than four axes their number behind it
        (`place_of`)."""
        return str(self.fields.port)

    def is_whole(self) -> bool:
        """Whether the content has the hash that its page names."""
        return bytes(self.fields.hash.tolist()) == digest(self.content)

    def is_signed(self, key: bytes) -> bool:
        """Whether the page has a valid signature (EdDSA with BLAKE2b) by the secret key of this 32-byte public key."""
        signed = self.page[_HEADER : _HEADER + wire.wire.IMAGE_SIGNED]
        return bool(monocypher.signature_check(bytes(self.fields.signature.tolist()), key, signed))


def digest(content: bytes) -> bytes:
    """Computes the hash of an image's content that its page holds: BLAKE2b-256, 32 bytes."""
    return hashlib.blake2b(content, digest_size=_HASH).digest()


def version_of(numbers: Sequence[int]) -> Version:
    """Makes a version, (major, minor, patch), of the three numbers in a message."""
    major, minor, patch = (int(number) for number in numbers)
    return major, minor, patch


def text_of(version: Version) -> str:
    """A version as text, such as "1.2.0"."""
    return ".".join(map(str, version))


def place_of(port: str, axes: int) -> str:
    """Returns the name that an image for this port and number of axes has in its page: PORT for four axes, PORT-AXES
    for fewer. A board so never gets an image that leaves some of its motors alone."""
    return port if axes == _AXES_MOST else f"{port}-{axes}"


def pack(content: bytes, port: str, version: Version, slot: int, sign: Callable[[bytes], bytes]) -> bytes:
    """Makes one image of an update file: its signed page, then the content, padded with FFh to whole pages. port: as of
    `place_of`; slot: the one that it is linked for, 0, 1 or ANY_SLOT; sign: returns the 64-byte signature of the bytes
    that it gets."""
    content += b"\xff" * (-len(content) % PAGE)
    fields: dict[str, Any] = {
        "format": _FORMAT,
        "slot": slot,
        "version": version,
        "protocol_major": PROTOCOL[0],
        "protocol_minor": PROTOCOL[1],
        "port": port,
        "size": len(content),
        "hash": tuple(digest(content)),
    }
    unsigned = wire.encode("image", 0, **fields)
    signature = sign(unsigned[_HEADER : _HEADER + wire.wire.IMAGE_SIGNED])
    return wire.encode("image", 0, **fields, signature=tuple(signature)).ljust(PAGE, b"\0") + content


def read(path: Path) -> list[Image]:
    """Reads the images of an update file and checks their hashes, not their signatures. TautError where the file cannot
    be read, is no update file, or is damaged."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise TautError(f"{path}: {error.strerror}: name an update file, such as a release's") from error
    images: list[Image] = []
    at = 0
    while at < len(data):
        page = data[at : at + PAGE]
        fields = next((message for message in wire.Decoder().feed(page) if message.name == "image"), None)
        if fields is None or fields.format != _FORMAT:
            what = "damaged" if images else "no update file of this format"
            raise TautError(f"{path}: is {what}: get it again, or name a file that 'taut update' takes")
        image = Image(page, data[at + PAGE : at + PAGE + fields.size], fields)
        if len(image.content) != fields.size or not image.is_whole():
            raise TautError(f"{path}: is damaged or cut short: get it again")
        images.append(image)
        at += PAGE + fields.size
    if not images:
        raise TautError(f"{path}: is empty: get it again")
    return images


def _check_port(path: Path, images: Sequence[Image], port: str, axes: int) -> None:
    """TautError where an image is for another port than this board's, or for another number of axes."""
    place = place_of(port, axes)
    others = {image.port for image in images} - {place}
    axes_of = {place_of(port, count): count for count in range(1, _AXES_MOST + 1)}
    if others and others <= axes_of.keys():
        counts = ", ".join(str(axes_of[other]) for other in sorted(others))
        raise TautError(f"{path}: is for a {port} with {counts} axes, this board has {axes}: get the file for {place}")
    if others:
        raise TautError(f"{path}: is for {', '.join(sorted(others))}, this board is {place}: get the file for {place}")


def check(path: Path, images: Sequence[Image], identity: wire.Message, runs: wire.Message, older_too: bool) -> Image:
    """Returns the image of an update file that goes into the board's free slot. TautError, with the reason, where the
    board would refuse every image, or one is not signed or is for another board. identity, runs: the board's messages
    `identity` and `firmware` (what it runs); older_too: whether an image of an older version is taken, too."""
    if runs.slot == ANY_SLOT and runs.refused == wire.code("UPDATES", "NO_SLOT"):
        raise TautError(wire.text("UPDATES", runs.refused))
    _check_port(path, images, str(identity.port), int(identity.axes))
    other_protocols = {int(image.fields.protocol_major) for image in images} - {wire.wire.MAJOR}
    if other_protocols:
        raise TautError(
            f"{path}: speaks protocol {max(other_protocols)}, this tautline speaks {wire.wire.MAJOR}: get one that fits"
        )
    key = bytes(runs.key.tolist())
    if not all(image.is_signed(key) for image in images):
        raise TautError(
            f"{path}: is not signed with the key that this board trusts ({key.hex()[:8]}...): get a file from whoever "
            "built its firmware, or flash it as the first time"
        )
    free = 1 if runs.slot == 0 else 0  # an update goes to the slot that does not run
    fits = [image for image in images if image.fields.slot in (free, ANY_SLOT)]
    if not fits:
        raise TautError(f"{path}: {wire.text('UPDATES', wire.code('UPDATES', 'LINKED'))}")
    if len(fits[0].content) > runs.room:
        raise TautError(f"{path}: {len(fits[0].content)} bytes are more than the {runs.room} that a slot has")
    if fits[0].version < version_of(runs.version) and not older_too:
        raise TautError(
            f"{path}: is firmware {text_of(fits[0].version)}, the board runs {text_of(version_of(runs.version))}: "
            "--force takes the older one all the same"
        )
    return fits[0]
