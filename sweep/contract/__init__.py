"""The interface of simulated systems and their engines: all that studies, analysis, runs and reports know of them."""
