"""Pages of the reference that are written anew with every build, from the program itself.

Settings come from the schemas that validate them, commands from their own ``--help``, names from their docstrings,
messages from provoking them (`docs/_build_tools/messages.py`). `pages` returns them, `write_pages` puts them into a folder.
"""

from __future__ import annotations

import importlib
import inspect
import os
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from snippets import counts_page

EXAMPLES = {
    "sweep.axes": '{"tracking.delay_s" = [0.0, 1e-4]}',
    "acquisition.shot_period_s": "1.5",
    "beams.focus_depth_m": "70e-3",
    "digitizer.acquisition_mode": '"npt"',
    "generators.amplitude_vpp": "1.0",
    "recording.source": '"echoes.npy"',
    "recording.sha256": '"9f86d081..."',
    "recording.format": '"npy"',
    "recording.first_sample_s": "80e-6",
    "recording.inferred": '["pulse_rate_hz, from the file"]',
    "medium.shear_modulus_pa": "9e3",
    "notes": '{ operator = "initials", temperature_c = 21.5 }',
    "medium.shear_viscosity_pa_s": "2.0",
    "sweep.axial_offset_m": "[-2e-3, 0.0, 2e-3]",
    "simulation.receive_chain.notch.centre_hz": "3e6",
    "simulation.receive_chain.notch.bandwidth": "0.5",
    "simulation.receive_chain.band_pass.centre_hz": "9e6",
    "simulation.receive_chain.band_pass.bandwidth": "0.33",
    "simulation.receive_chain.second_band_pass.centre_hz": "9e6",
    "simulation.receive_chain.second_band_pass.bandwidth": "0.33",
    "digitizer.library": '"/usr/local/lib/libATSApi.so"',
    "digitizer.monitor_range_v": "4.0",
    "generators.address": '"GPIB0::10::INSTR"',
    "generators.interface": '"PRLGX-TCPIP0::192.168.1.20::1234::INTFC"',
    "generators.max_vpp": "2.0",
    "beams.push_focus_depth_m": "70e-3",
    "transducers.push.focus_depth_m": "70e-3",
    "transducers.push.width_m": "[0.34e-3, 0.34e-3, 3.60e-3]",
    "transducers.tracking.diameter_m": "20e-3",
    "transducers.tracking.focus_depth_m": "40e-3",
    "transducers.tracking.pulse_length_m": "1.32e-3",
    "transducers.tracking.width_m": "[0.078e-3, 0.078e-3, 0.83e-3]",
    "simulation.beams.tracking_focus_depth_m": "40e-3",
    "processing.expected_amplitude_m": "500e-9",
    "processing.expected_snr_db": "40.0",
    "processing.gate_profile_step_m": "0.5e-3",
    "processing.gates.depth_m": "70.5e-3",
    "processing.gates.length_m": "0.8e-3",
    "beams.excitation_scan": '"push.csv"',
    "simulation.beams.excitation_scan": '"push.h5"',
    "simulation.beams.tracking_scan": '"tracking.h5"',
    "processing.harmonic": '"least_squares"',
    "processing.reference_gate_depth_m": "66e-3",
    "processing.reference_gate_length_m": "1e-3",
    "simulation.beams.width_ratio": "[2.2, 2.2, inf]",
    "simulation.receive_chain.noise_v_per_sqrt_hz": "2e-9",
    "simulation.receive_chain.preset": '"paper"',
    "simulation.receive_chain.recovery_time_s": "5e-6",
    "simulation.scatterers.echo_tolerance": "1e-3",
    "simulation.scatterers.measured_pulse": "[0.0, 0.4, -1.0, 0.4, 0.0]",
    "simulation.specimen.preset": '"gelatin_8"',
    "simulation.transmitter.saturation_v": "100.0",
    "simulation.transmitter.hybrid_saturation_v": "2.0",
    "simulation.specimen.depth_m": "12.5e-3",
    "title": '"Gelatin, 100 us at 200 Hz"',
    "tracking.pulse_count": "800",
    "transport": '"socket"',
}
"""Examples of keys that no shipped file sets and that have no default."""
PURPOSE = {
    "scene": "A scene says what is measured and on which specimen. `hpe-rig new my-scene --full` writes one with every "
    "key below in a comment.",
    "bench": "A bench file says which instruments there are, where they answer, how they are wired and what they must "
    "never exceed. `hpe-rig new my-bench --like bench --full` writes one with every key below in a comment.",
    "simulation": "What the twin simulates: the section `[simulation]` of a scene. A real bench never reads it.",
}
ROOT = Path(__file__).parents[2]
ROOMS = tuple(
    ".".join(stub.parent.relative_to(ROOT).parts)
    for package in ("hpe_rig", "drivers", "sim_backend")
    for stub in sorted((ROOT / package).glob("*/__init__.pyi"))
)
"""Folders that offer names to others."""


def pages() -> dict[str, str]:
    """Return the generated pages, Markdown by file name."""
    settings = {f"{of}.md": settings_page(of) for of in PURPOSE}
    found = {
        "commands.md": commands_page(),
        "api.md": api_page(),
        "rooms.md": rooms_page(),
        "snippets.md": counts_page(),
    }
    return {**settings, **found}


def write_pages(folder: Path) -> None:
    """Write the generated pages into ``folder``; a page that has not changed is left alone, and not built again."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in {**pages(), **messages_pages()}.items():
        path = folder / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def settings_page(of: str) -> str:
    """Return the page of a ``"scene"``, a ``"bench"`` file or ``"simulation"``: every key, from the schema."""
    from hpe_rig.runs import settings_tables
    from hpe_rig.scene.description import toml_value

    lines = [f"# Keys of {'[simulation]' if of == 'simulation' else f'a {of}'}", "", PURPOSE[of], ""]
    lines += [
        "Every number is in the SI unit that ends its key. A key that is out of its bounds, or that nothing knows, "
    ]
    lines += ["is refused before anything is opened, with its name and what to try.", ""]
    set_in_shipped = _examples(of)
    for table in settings_tables(of):
        name = ".".join(table.path)
        if name:
            presence = "required" if table.required else "may be absent"
            lines += [f"## {table.header}", "", f"{table.text} *({presence})*", ""]
        if not table.keys:
            continue
        lines += ["| key | what it says | value | default | example |", "|---|---|---|---|---|"]
        for key in table.keys:
            path = f"{name}.{key.name}" if name else key.name
            found = set_in_shipped.get(path)
            known = _any_generator(path)
            found = None if path == "title" else found
            example = toml_value(found) if found is not None else key.default or EXAMPLES.get(known)
            if example in (None, "[]"):
                example = EXAMPLES.get(known)
            default = "**required**" if key.required else f"`{key.default}`" if key.default else "absent"
            if example is None and key.default is not None:
                # An empty list or table is what may stand there, if nothing better is known.
                example = key.default
            shown = f"`{example}`" if example else ""
            value = f"{key.kind}{f' in {key.unit}' if key.unit else ''}{f', {key.bounds}' if key.bounds else ''}"
            row = (f"`{key.name}`", key.text, value, default, shown)
            lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |")
        lines.append("")
    return "\n".join(lines)


def _any_generator(path: str) -> str:
    """Return the path of a key with the role of a generator left out: they all have the same keys."""
    first, *rest = path.split(".")
    return f"generators.{rest[-1]}" if first == "generators" else path


def _examples(of: str) -> dict[str, Any]:
    """Return the value that a shipped file sets, by path; the first file in the alphabet that does."""
    from hpe_rig.bench import read_bench
    from hpe_rig.scene import shipped_scenes

    texts = [read_bench().text] if of == "bench" else list(shipped_scenes().values())
    found: dict[str, Any] = {}
    for text in texts:
        for path, value in _flat(tomllib.loads(text)):
            found.setdefault(path, value)
    return found


def _flat(table: Mapping[str, Any], path: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        here = f"{path}.{key}" if path else key
        if isinstance(value, Mapping):
            yield from _flat(value, here)
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            yield from _flat(value[0], here)
        else:
            yield here, value


def commands_page() -> str:
    """Return the page of the commands: the help of each, as it prints it."""
    lines = ["# Commands", "", "`hpe-rig COMMAND --help` prints what stands here.", ""]
    for words in command_names():
        lines += [f"## hpe-rig {' '.join(words)}".rstrip(), "", "```text", _help(words), "```", ""]
    lines += EXIT_CODES.splitlines()
    return "\n".join(lines) + "\n"


EXIT_CODES = """## Exit codes

| code | meaning |
|---:|---|
| 0 | success |
| 1 | an instrument failed |
| 2 | a mistake in a scene, a file or an option |
| 3 | an output may still be on |
| 4 | `verify`: the file is damaged |
| 5 | `verify`: the file holds no checksums |
| 70 | an error of the program itself |
| 130 | interrupted by Ctrl-C; 128 plus its number for any other signal |
"""


def command_names() -> list[tuple[str, ...]]:
    """Return the words of every command, the program itself first: ``()``, ``("run",)``, ..."""
    import typer

    from hpe_rig.cli import commands

    return list(_commands(typer.main.get_command(commands)))


def _commands(command: Any, words: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    yield words
    for name, inner in getattr(command, "commands", {}).items():
        if not inner.hidden:
            yield from _commands(inner, (*words, name))


def _help(words: tuple[str, ...]) -> str:
    from typer.testing import CliRunner

    from hpe_rig.cli import commands

    environment = {"COLUMNS": "100", "TERMINAL_WIDTH": "100"}
    done = CliRunner().invoke(commands, [*words, "--help"], env=environment, prog_name="hpe-rig")
    return done.stdout.strip("\n")


def api_page() -> str:
    """Return the page of the public API: what ``import hpe_rig`` offers, from the docstrings."""
    import hpe_rig

    lines = ["# Python API", "", "`import hpe_rig as hpe` offers the names on this page, each loaded on first use.", ""]
    lines += ["```python", *_example(hpe_rig.__doc__ or ""), "```", ""]
    lines += ["A scene is a name, a path or a `Scene` wherever one is taken.", "", "```{eval-rst}"]
    for name in sorted(hpe_rig.__all__, key=lambda name: (inspect.isclass(getattr(hpe_rig, name)), name)):
        offered = getattr(hpe_rig, name)
        if inspect.isclass(offered):
            lines += [f".. autoclass:: hpe_rig.{name}", "   :members:", "   :exclude-members: model_config", ""]
        else:
            lines += [f".. autofunction:: hpe_rig.{name}", ""]
    return "\n".join([*lines, "```", ""])


def _example(docstring: str) -> list[str]:
    from doctest import DocTestParser

    return [example.source.rstrip() for example in DocTestParser().get_examples(docstring)]


def rooms_page() -> str:
    """Return the page of the rooms: what each offers to the others, with the first sentence of its docstring."""
    lines = ["# Inside the rooms", "", "What each folder offers to the others. Scripts need "]
    lines += ["[the public API](api.md) alone; these names may change from one release to the next.", ""]
    for room in ROOMS:
        module = importlib.import_module(room)
        lines += [f"## {room}", "", _sentence(module.__doc__ or ""), "", "| name | what it is |", "|---|---|"]
        lines += [f"| `{name}` | {about} |" for name, about in offered_names(module)]
        lines.append("")
    return "\n".join(lines)


def offered_names(module: Any) -> list[tuple[str, str]]:
    """Return the names that a room offers, each with the first sentence of its docstring; a constant with its type."""
    found = []
    for name in sorted(module.__all__):
        offered = getattr(module, name)
        own = inspect.isclass(offered) or inspect.isroutine(offered)
        about = _sentence(inspect.getdoc(offered) or "") if own else f"constant, {type(offered).__name__}"
        found.append((name, about))
    return found


def _sentence(text: str) -> str:
    first = " ".join(text.split("\n\n")[0].split()).replace("``", "`").replace("|", "\\|")
    return first.partition(". ")[0].removesuffix(".") + "."


def messages_pages() -> dict[str, str]:
    """Return the pages of the error messages, each provoked in an empty folder, and of what was answered before."""
    import sys

    sys.path.insert(0, os.fspath(Path(__file__).parent))
    from messages import beside, markdown

    return {"messages.md": markdown(), "messages-before.md": beside()}
