"""What talks to metal: each driver speaks to its instrument through a wire that a real transport or the twin provides."""
