"""Scene: what is measured and on which specimen, as its TOML file says, validated at once; no room lies below.

    validation.py   every mistake of a settings file at once, each with its key, the bound and what to try
    quantities.py   types of the numbers in settings files, each with the bounds of what exists
    notes.py        what an operator notes beside the settings, by names of their own
    scene.py        the sections of a scene; read by name, path or value; the shipped scenes; the default specimen
    notation.py     numbers with units as people read them
    keys.py         the numbers of a scene: found by a short name, set to a value
    description.py  every key of a settings file in words, from the schema; a file that names them all
    axis.py         axes of a sweep and the points that they span
    points.py       the points of a sweep over any numbers
    editing.py      a scene's text with some of its numbers changed, comments kept

Others use ``load_scene`` and ``Scene``, and ``SettingsError`` with its ``Mistake`` for settings files of their own.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
