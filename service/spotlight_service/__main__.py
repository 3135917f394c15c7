"""``python -m spotlight_service``."""

from spotlight_service.command import main

main()
