"""Who may do what, how often, and what is let in at all."""
