from .command import Request as Request, write_design as write_design
