"""Images of SD cards, laid out by hand from Microsoft's FAT specification, with a file for the meter to write into."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

BLOCK = 512
NAME = b"INA219  BIN"
_BLOCKS_A_CLUSTER = 4
_PARTITION = 64  # block where the partition begins, where there is one
_RESERVED = 32
_TABLE_BLOCKS = 8
_ROOT_ENTRIES = 64
_END = {16: 0xFFFF, 32: 0x0FFFFFFF}


@dataclass(frozen=True)
class CardImage:
    """A card: where its file lies, in the image that the board reads and writes.

    Attributes:
        path: the image.
        clusters: those of the file, in order.
        first_data: block of cluster 2.
    """

    path: Path
    clusters: tuple[int, ...]
    first_data: int

    def content(self) -> bytes:
        """Return the bytes of the file, as a computer would copy them."""
        image = self.path.read_bytes()
        blocks = [self.first_data + (cluster - 2) * _BLOCKS_A_CLUSTER for cluster in self.clusters]
        return b"".join(image[block * BLOCK : (block + _BLOCKS_A_CLUSTER) * BLOCK] for block in blocks)

    def copy_to(self, file: Path) -> Path:
        """Copy the file off the card."""
        file.write_bytes(self.content())
        return file


def make_card(
    path: Path, *, clusters: tuple[int, ...] = tuple(range(5, 105)), bits: int = 16, is_partitioned: bool = True
) -> CardImage:
    """Make a card with an empty INA219.BIN on these clusters; without any, it has other files only.

    Args:
        path: where the image is written.
        clusters: of the file, in order; 2048 bytes each.
        bits: 16 or 32, of the file system.
        is_partitioned: whether there is a partition table before it, as on cards that one buys.
    """
    start = _PARTITION if is_partitioned else 0
    root_blocks = _ROOT_ENTRIES * 32 // BLOCK if bits == 16 else 0
    first_data = start + _RESERVED + 2 * _TABLE_BLOCKS + root_blocks
    root = start + _RESERVED + 2 * _TABLE_BLOCKS if bits == 16 else first_data  # FAT32: the folder is cluster 2
    image = bytearray((first_data + 200 * _BLOCKS_A_CLUSTER) * BLOCK)
    if is_partitioned:
        image[446 + 8 : 446 + 12] = struct.pack("<I", start)
        image[510:512] = b"\x55\xaa"
    image[start * BLOCK : (start + 1) * BLOCK] = _boot_sector(bits)
    table = (start + _RESERVED) * BLOCK
    image[table : table + _TABLE_BLOCKS * BLOCK] = _table(clusters, bits)
    image[root * BLOCK : root * BLOCK + 96] = _folder(clusters)
    path.write_bytes(image)
    return CardImage(path, clusters, first_data)


def _boot_sector(bits: int) -> bytes:
    sector = bytearray(BLOCK)
    sector[0:3] = b"\xeb\x3c\x90"
    root_entries, table_blocks = (_ROOT_ENTRIES, _TABLE_BLOCKS) if bits == 16 else (0, 0)
    struct.pack_into(
        "<HBHBHHBH", sector, 11, BLOCK, _BLOCKS_A_CLUSTER, _RESERVED, 2, root_entries, 0, 0xF8, table_blocks
    )
    if bits == 32:
        struct.pack_into("<I", sector, 36, _TABLE_BLOCKS)
        struct.pack_into("<I", sector, 44, 2)
    at = 54 if bits == 16 else 82
    sector[at : at + 8] = f"FAT{bits}   ".encode()
    sector[510:512] = b"\x55\xaa"
    return bytes(sector)


def _table(clusters: tuple[int, ...], bits: int) -> bytes:
    entries = [0] * (_TABLE_BLOCKS * BLOCK * 8 // bits)
    entries[0] = entries[1] = entries[2] = _END[bits]
    following = dict(pairwise(clusters))
    for cluster in clusters:
        entries[cluster] = following.get(cluster, _END[bits])
    return struct.pack(f"<{len(entries)}{'H' if bits == 16 else 'I'}", *entries)


def _folder(clusters: tuple[int, ...]) -> bytes:
    label = b"METER      " + bytes([0x08]) + bytes(20)
    other = _entry(b"README  TXT", 4, 0)
    return (
        label
        + other
        + (_entry(NAME, clusters[0], len(clusters) * _BLOCKS_A_CLUSTER * BLOCK) if clusters else bytes(32))
    )


def _entry(name: bytes, cluster: int, size: int) -> bytes:
    return name + bytes([0x20]) + bytes(8) + struct.pack("<HHHHI", cluster >> 16, 0, 0, cluster & 0xFFFF, size)
