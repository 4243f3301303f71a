"""Live page of a run, a queue or an alignment, on this machine only.

process.py     the page's own process, so that no browser holds up a run: ``live_page_of``, ``serve_run``, ``open_page``
server.py      loopback, a token in the address, a task a viewer
source.py      run file -> state
queue_source.py  a queue's list and the file of the run that goes on -> state
history.py     amplitudes over shots, time left, warnings
alignment.py   single tracking shots -> state: ``align``, ``without_pushing``
state.py       state as small plain values for JSON
live.html      the page

Others use these functions, and ``PageProcess``, what ``live_page_of`` yields.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
