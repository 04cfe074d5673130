"""The three systems that a bundle may be. Each is one file, which reads from top to bottom like its paper.

    paper      Rhythmic Gesticulator (RG): a lexicon of poses, a regression generator with style codes
    movement   the default: a lexicon of movements, gesture units, a flow generator that samples
    racer      RACER: a codec at a fixed rate, and a Q-network that chooses among its codes

`Config.system` names one; the rest of the product asks it through `gesticulator.bundle.models.System`.
"""
