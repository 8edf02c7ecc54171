"""Whether a dask scheduler answers at an address: dask itself takes half a minute to say that none does.

Both sides of a connection of dask begin with a short message, its length first (8 bytes, little-endian).
"""

from __future__ import annotations

import re
import socket

from adaptmg.problem import checks

__all__ = ["check_scheduler"]

_PATIENCE_S = 3.0
#: bytes of a greeting
_LONGEST = 1_000_000
_ADDRESS = re.compile(r"(tcp|tls|ws|wss|ucx)://(\[[^\]]+\]|[^:/\[\]\s]+):(\d+)/?")


def check_scheduler(address: str) -> None:
    """Connect once.

    Raises
    ------
    ValueError
        If it is no address.
    OSError
        If nobody, or somebody else, answers there.
    """
    found = _ADDRESS.fullmatch(address)
    if not found or not 0 < int(found[3]) < 65536:
        raise ValueError(f"--scheduler must be an address such as tcp://host:8786, got {checks.shown(address)}")
    start = "start one with 'dask scheduler', which prints its address"
    try:
        with socket.create_connection((found[2].strip("[]"), int(found[3])), _PATIENCE_S) as connection:
            if found[1] != "tcp":
                return
            connection.settimeout(_PATIENCE_S)
            length = int.from_bytes(connection.recv(8), "little")
    except TimeoutError:
        length = 0
    except OSError as error:
        raise OSError(f"--scheduler: nobody answers at {address} ({error.strerror or error}): {start}") from None
    if not 0 < length <= _LONGEST:
        raise OSError(f"--scheduler: what answers at {address}, if anything does, is no dask scheduler: {start}")
