"""Files of an imaginary bench: a line of text with the rates, then 16-bit samples, pulse by pulse."""

import json

import numpy as np

from hpe_rig.recordings import Contents


class BenchX:
    """Reader of ``.bx`` files: {"fs": 5e7, "prf": 4000, "fc": 5e6, "samples": 256} and a line end, then int16."""

    suffixes = (".bx",)

    def read(self, path, settings):
        """Return the samples and the settings in the first line."""
        head, _, data = path.read_bytes().partition(b"\n")
        try:
            header = json.loads(head)
            samples = np.frombuffer(data, "<i2").reshape(-1, header["samples"])
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"this is not a file of bench X ({error}). Try: record it again") from error
        names = {"fs": "sample_rate_hz", "prf": "pulse_rate_hz", "fc": "carrier_hz"}
        stated = {key: (float(header[name]), name) for name, key in names.items() if name in header}
        return Contents({path.stem: samples}, stated, axes=("pulse", "sample"))
