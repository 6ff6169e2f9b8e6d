"""`make bam`: what `rig identify` says of servos with the friction that Rhoban/bam publishes, simulated apart."""
