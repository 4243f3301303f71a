"""Time a full simulated measurement, 20 bursts, 800 records of 2048 samples, with and without the receive chain.

One core: OMP_NUM_THREADS=1. The first run of a process tabulates the medium's field and imports what it needs; later
ones of the scene keep both. Processor time does not count what else the machine does, wall time does.
"""

import time
from pathlib import Path
from tempfile import TemporaryDirectory

from hpe_rig.acquire import prepare_text, process, record_run
from hpe_rig.result import Stages
from hpe_rig.scene import shipped_scenes

REPEATS = 5
CHAIN = """
[simulation.receive_chain]
preset = "paper"
noise_v_per_sqrt_hz = 5.5e-9
"""


def main() -> None:
    """Print processor time and wall time of each stage in ms: the first measurement, and the fastest of five more."""
    text = shipped_scenes()["bovine-muscle-synchronous"].replace("snr_db = 40.0", "").split("# paper, Sec. V.B")[0]
    text = text.replace("[acquisition]", "[acquisition]\nrecord_samples = 2048")
    for name, scene in (("whole receive chain, noise", text + CHAIN), ("without chain and noise", text)):
        times = [seconds(scene) for _ in range(REPEATS + 1)]
        for which, (processor_s, each) in (("first", times[0]), ("later", min(times[1:], key=lambda one: one[0]))):
            stages = ", ".join(f"{stage} {time_s * 1e3:.0f}" for stage, time_s in each.items() if time_s > 5e-4)
            print(
                f"{name}, {which}: processor {processor_s * 1e3:.0f} ms, wall {sum(each.values()) * 1e3:.0f} ({stages})"
            )


def seconds(text: str) -> tuple[float, dict[str, float]]:
    """Return processor time of one measurement from scene to result, and its wall time by stage, s."""
    stages, start_s = Stages(), time.process_time()
    with TemporaryDirectory() as folder:
        setup = prepare_text("timed", text, stages=stages)
        process(record_run(setup, Path(folder) / "run.h5", stages=stages), stages=stages)
    return time.process_time() - start_s, stages.run_time_s


if __name__ == "__main__":
    main()
