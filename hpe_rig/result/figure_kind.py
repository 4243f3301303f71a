"""Kinds of figures of a result, in a module without imports of large packages."""

from typing import Literal

FigureKind = Literal["spectrum", "displacement", "drive", "distance", "profile"]
"""Kind of a figure: the module ``figure`` lists what each kind draws."""
