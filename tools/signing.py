"""Keys and signatures of firmware updates.

python tools/signing.py key FILE                          a new key pair: FILE and FILE.pub, where there is none yet
python tools/signing.py sign FILE PORT OUT IMAGE...       an update file of the image for slot 0, that for slot 1, ...

FILE holds the secret key, 64 bytes as hexadecimal digits: whoever has it can give boards firmware. FILE.pub goes into
the image (TAUTLINE_UPDATE_KEY). The version is TL_APP_VERSION.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import monocypher

from tautline.device.firmware import ANY_SLOT, Version, pack

ROOT = Path(__file__).resolve().parents[1]


def make_key(file: Path) -> bytes:
    """The public key of the pair in `file`, which is made where there is none."""
    if not file.is_file():
        secret, public = monocypher.generate_signing_key_pair()
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch(0o600)
        file.write_text(secret.hex() + "\n", encoding="ascii")
        file.with_name(file.name + ".pub").write_text(public.hex() + "\n", encoding="ascii")
    return public_key(file)


def secret_key(file: Path) -> bytes:
    return bytes.fromhex(file.read_text(encoding="ascii").strip())


def public_key(file: Path) -> bytes:
    return bytes(monocypher.compute_signing_public_key(secret_key(file)))


def version() -> Version:
    header = (ROOT / "firmware/app/include/tautline/tl_command.h").read_text("utf-8")
    found = re.search(r"TL_APP_VERSION \{(\d+), (\d+), (\d+)\}", header)
    assert found is not None
    return int(found[1]), int(found[2]), int(found[3])


def update_file(key: bytes, port: str, images: list[bytes], of: Version) -> bytes:
    """`images`: of slot 0, slot 1; or one, for any."""

    def sign(message: bytes) -> bytes:
        return bytes(monocypher.signature_sign(key, message))

    slots = range(len(images)) if len(images) > 1 else [ANY_SLOT]
    return b"".join(pack(image, port, of, slot, sign) for slot, image in zip(slots, images, strict=True))


def main(arguments: list[str]) -> int:
    match arguments:
        case ["key", file]:
            print(make_key(Path(file)).hex())
        case ["sign", file, port, out, *images] if images:
            contents = [Path(image).read_bytes() for image in images]
            Path(out).write_bytes(update_file(secret_key(Path(file)), port, contents, version()))
        case _:
            print(__doc__, file=sys.stderr)
            return 2
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
