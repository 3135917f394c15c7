from hypothesis import settings

settings.register_profile(
    "repeatable", deadline=None, database=None, derandomize=True, max_examples=60
)
settings.load_profile("repeatable")
