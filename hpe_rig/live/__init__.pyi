from .alignment import align as align, band_percent as band_percent, without_pushing as without_pushing
from .process import (
    live_page_of as live_page_of,
    open_page as open_page,
    serve_run as serve_run,
)
