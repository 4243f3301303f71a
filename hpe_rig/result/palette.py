"""Palette of every figure, after Okabe and Ito: for colour-blind readers too, each of contrast 3:1 or more on white."""

PALETTE = ("#0072B2", "#D55E00", "#007A5A", "#8A4F7D", "#5A5A5A", "#A87400", "#2F8FC4", "#000000")
