"""The published right-triangle algorithms, each in one page of plain Python, as its paper prints it.

Read a page beside its paper; then the method in ``orograph.lod`` that does the same fast. The methods are tested
against these pages, so they are right, and slow: dictionaries, sets and recursion, for rasters of some hundred samples.

=======================  ===============================================================================
``children``             triangles (l, L, ω) and diamonds: who is whose child, sibling, parent
``terrain``              what all pages work on: the vertices of a small raster, with errors and spheres
``camera``               a view in the numbers that the criteria need
``criterion``            from metres to pixels: which diamonds and triangles are accurate
``top_down``             refinement with forced splits (lecture; ROAM without its memory)
``roam``                 Duchaineau et al. 1997: a split queue and a merge queue, from frame to frame
``soar``                 Lindstrom & Pascucci 2001: ten lines of recursion that leave one triangle strip
``threshold_spheres``    Blow 2000: spheres around the diamonds, split while the eye is inside
``stateless``            the lecture's refinement that remembers nothing, for monotonic criteria
``restricted_quadtree``  squares whose neighbours differ by one level at most, cut in three ways
``smart``                Bao et al. 2004: blocks, ranges of errors, and which vertices they make active
``seamless_patches``     Livny et al. 2009: squares of a quadtree, and how fine each of their edges is
``cdlod``                Strugar 2009: squares by distance, and how far their vertices slide
``chunked_lod``          Ulrich 2002: meshes of chunks, their skirts, which are drawn, how far they have moved
``quadtin``              Pajarola et al. 2002: a hierarchy over irregular points, and the mesh of a view
``hyperblock``           Lario et al. 2003: blocks of that hierarchy at given levels, and what they draw
``cbt``                  Dupuy 2020: a heap of bits and sums, split and merged by all leaves at once
``bdam``                 Cignoni et al. 2003: patches of a view, and which vertices of theirs may move
=======================  ===============================================================================
"""
