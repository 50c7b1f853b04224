"""The electromechanical model: simulate, fit, predict the runtime."""
