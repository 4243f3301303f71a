"""What talks to metal: each driver speaks through a wire that a real transport or the twin provides."""
