"""What survives: jobs and keys in SQLite, scenes and results on disk."""
