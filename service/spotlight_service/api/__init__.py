"""Routes, one file a subject; each checks, asks a store or the studio, and answers."""
