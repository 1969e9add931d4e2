#version 460
// Updates T by the registration step, where a pass of its own does. CPU reference:
// src/engine/stages/update_transform.rs.

#extension GL_EXT_control_flow_attributes : require

#include "state.glsl"
#include "sums.glsl"

layout(local_size_x = 64, local_size_y = 4, local_size_x_id = 0, local_size_y_id = 1) in;
layout(binding = 0, std430) readonly buffer Partials { float partials[]; };
layout(binding = 1, std430) buffer StateBuffer { State updated; };
layout(binding = 2, std430) writeonly buffer Energies { float energies[]; };
layout(binding = 3, std430) writeonly buffer Arguments { uint arguments[]; };
layout(binding = 4, std430) readonly volatile buffer AllArguments { uint start_arguments[]; };

layout(push_constant) uniform Constants {
    int rows;                        // of partial sums
    float factor;                    // pixels of the full-size image per pixel of this level
    float scale_length;              // L
    float half_size[2];              // from the centre to a corner, pixels
    Step t_step;
};

int rows_of_sums() { return rows; }
float length_of_places() { return scale_length; }
vec2 corner_place() { return vec2(half_size[0], half_size[1]); }

#include "update_transform.glsl"

void main() {
    update_transform();
}
