"""Live page of a run, a queue or an alignment, on this machine only.

    state.py         state as small plain values for JSON
    history.py       amplitudes over shots, remaining time, warnings
    source.py        run file -> state
    queue_source.py  a queue and the file of its current run -> state
    server.py        loopback server with a token in the address and a task for each viewer
    alignment.py     single tracking shots -> state: `align`
    process.py       the page's separate process, so that no browser delays a run: `live_page_of`, `serve_run`
    live.html        the page

The command line uses these functions.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
