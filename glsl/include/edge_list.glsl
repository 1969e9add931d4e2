// The cell of a workgroup, by the list of cells with an edge. Bindings: the arguments; the list.

// It is at a negative place if the list has ended.
ivec2 listed_cell() {
    uint n = gl_WorkGroupID.y * uint(ALONG_X) + gl_WorkGroupID.x;
    if (n >= arguments[argument_place + COUNT_PLACE]) return ivec2(-1);
    uint cell = listed[n];
    return ivec2(cell & ((1u << ROW_BIT) - 1u), cell >> ROW_BIT);
}
