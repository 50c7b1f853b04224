"""From signals to the folded cycle: period, crank angle, folding, quality."""
