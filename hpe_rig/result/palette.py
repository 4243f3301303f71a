"""Palette of every figure, after Okabe and Ito: told apart by colour-blind readers, and dark enough on white."""

PALETTE = ("#0072B2", "#D55E00", "#007A5A", "#8A4F7D", "#5A5A5A", "#E69F00", "#56B4E9", "#000000")
