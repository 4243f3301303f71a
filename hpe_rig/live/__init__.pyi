from .alignment import align as align
from .process import live_page_of as live_page_of, open_page as open_page, serve_run as serve_run
