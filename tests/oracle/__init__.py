"""SpotLight a second time: the paper's equations, read literally, in float64 torch.

Nothing here is fast, batched or guarded, and nothing imports the runtime. Maps are tensors of shape
(C, H, W), latents (4, h, w), and every function computes in the precision it is given.
"""
