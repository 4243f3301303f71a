from .app import commands as commands
from .entry import main as main
