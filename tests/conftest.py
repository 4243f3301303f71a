"""One thread of linear algebra, as the command line sets it: many small matrices gain nothing from more."""

import os

for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
