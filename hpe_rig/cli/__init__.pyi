from .app import main as main
from .tables import print_result as print_result
