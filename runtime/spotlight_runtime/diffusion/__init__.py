"""The sampler and all it is made of: schedule, solvers, guidance, shadow blending."""
