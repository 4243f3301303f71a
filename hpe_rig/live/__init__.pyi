from .alignment import align as align, without_pushing as without_pushing
from .process import live_page_of as live_page_of, serve_run as serve_run
