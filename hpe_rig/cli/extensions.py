"""Extensions on the terminal: what other packages bring, each loaded and looked at."""

from __future__ import annotations

from collections.abc import Callable

from hpe_rig.extensions import ESTIMATORS, IMPORTERS, MEDIA, installed, origin


def extension_lines() -> tuple[list[str], bool]:
    """Return a line for every installed extension, and whether all of them load and are what their groups take."""
    from hpe_rig.moduli import law_of
    from hpe_rig.processing import spec_of
    from hpe_rig.recordings import foreign_importer

    checks: dict[str, Callable[[str], object]] = {ESTIMATORS: spec_of, MEDIA: law_of, IMPORTERS: foreign_importer}
    lines, sound = list[str](), True
    for group, check in checks.items():
        for name in installed(group):
            try:
                check(name)
                lines.append(origin(group, name))
            except ValueError as error:
                lines.append(f"FAILS {error}")
                sound = False
    return lines or ["no package brings an extension; docs/how-to/extend.md says how one does"], sound
