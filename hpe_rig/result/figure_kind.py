"""Kinds of figures of a result, in a module without imports of large packages."""

from typing import Literal

FigureKind = Literal["spectrum", "displacement", "drive", "distance", "profile"]
"""Horizontal axis of a figure: see ``figure``."""
