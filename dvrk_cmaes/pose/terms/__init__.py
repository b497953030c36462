"""What a pose should agree with: one term for each kind of evidence, each with its value and its derivatives."""
