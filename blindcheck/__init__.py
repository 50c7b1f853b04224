"""The withheld-effect check, with a plant of its own."""
