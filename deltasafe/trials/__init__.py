"""Trials: logged scenes taken through the chain, from the image to the executed motion and the evidence about it."""
