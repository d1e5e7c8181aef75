"""Settings of PhysiCell as a scene: one file for each part of them.

Sources of the meaning of elements: Ghaffarizadeh et al., PLoS Comput. Biol. 14 (2018) e1005991, and
PhysiCell's user guide; of the fields Ghaffarizadeh, Friedman and Macklin, Bioinformatics 32 (2016)
1256 (BioFVM); of the rules Johnson et al., Cell 188 (2025) 4711.
"""
