"""What computes, in processes of its own: workers relight, the studio does everything else."""
