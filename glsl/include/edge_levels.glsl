// The push constants of the passes between the finest and a coarser level of the search for outlines.

layout(push_constant) uniform Constants {
    int width, height;                   // of the coarser level
    int finest[2];                       // width and height of the finest level
    int pixels;                          // of the finest level along a pixel of the coarser one
    int apart;                           // distance of the samples, pixels of the finest level
    float scale;                         // V here by V of the finest: 1/pixels², or 1 for values without pixels
};
