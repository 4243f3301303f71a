from .alignment import align as align, without_pushing as without_pushing
from .process import (
    PageProcess as PageProcess,
    live_page_of as live_page_of,
    open_page as open_page,
    serve_run as serve_run,
)
