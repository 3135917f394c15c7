"""What a relight will do, why, and what it will cost: decided before any network runs."""
