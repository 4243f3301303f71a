"""``python -m hpe_rig`` is ``hpe-rig``."""

from hpe_rig.cli import main

if __name__ == "__main__":
    main()
