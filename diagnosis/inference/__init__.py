"""From a campaign to probabilities: noise, nuisances, hypotheses, posterior."""
