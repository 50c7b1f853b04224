"""Every effect the blind check can hide in a campaign, each with an equation of its own."""
