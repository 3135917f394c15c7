"""Thousands of relights in one process: neither memory nor time grows."""
