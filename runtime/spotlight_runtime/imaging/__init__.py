"""Pictures in and out: headers, decoding, colour, denoising, guided upsampling."""
