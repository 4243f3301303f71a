"""Optional packages: a missing one is reported with the extra that brings it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from hpe_rig.store.format import StoreError


@contextmanager
def extra(name: str) -> Iterator[None]:
    """Turn a package that is missing inside the block into a ``StoreError`` that names the extra ``name``."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise StoreError(
            f'this needs {error.name}, which is not installed. Try: pip install "hpe-rig[{name}]".'
        ) from None
