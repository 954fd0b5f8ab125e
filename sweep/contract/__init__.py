"""What a simulated system and its engines offer: all that studies, analysis, runs and reports know of them."""
