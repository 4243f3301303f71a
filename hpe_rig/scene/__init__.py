"""Scene: the measurement and the specimen, read from TOML and validated at once.

    mistakes.py          mistakes with path, cause and remedy; SettingsError reports all of them at once
    units.py             units of keys, numbers with a unit, lengths on the command line
    settings_file.py     text and TOML of a settings file
    estimator_table.py   estimators that a scene can name, with their properties
    removed_keys.py      keys of earlier versions
    validation.py        all mistakes in the settings of a model
    quantities.py        types of values, each with its bounds
    sections.py          the sections of a scene
    keys.py              numbers of a scene by short name or path
    axis.py              axes of a sweep and the points that they span
    usual_values.py      the shipped scenes, and the suggestion for a number without its unit's prefix
    scene.py             the scene and the points of its sweep
    loading.py           scenes by name, path or value; the default specimen
    editing.py           numbers changed in a scene's text, comments kept
    description.py       every key in words, from the schema; a file that lists them all

Other packages use ``load_scene``, ``Scene``, and ``SettingsError`` with ``Mistake`` for their own settings files.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
