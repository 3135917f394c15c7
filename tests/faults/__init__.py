"""What happens to files when processes are killed, disks fill up, models change, clocks jump."""
