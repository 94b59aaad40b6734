// Made by `spgs-dev spirv` from the table in engine/src/scene/parameter.rs. Place of each parameter in that table: of its
// learning rate in Step and of its reports in status; first plane in moments and gradients.
#ifndef SPGS_PARAMETERS
#define SPGS_PARAMETERS

const uint PARAMETERS = 10u;
const uint PARAMETER_MEAN = 0u;
const uint PLANE_MEAN = 0u;
const uint PARAMETER_LOG_SCALE = 1u;
const uint PLANE_LOG_SCALE = 3u;
const uint PARAMETER_ROTATION = 2u;
const uint PLANE_ROTATION = 6u;
const uint PARAMETER_OPACITY_LOGIT = 3u;
const uint PLANE_OPACITY_LOGIT = 10u;
const uint PARAMETER_SH_0 = 4u;
const uint PLANE_SH_0 = 11u;
const uint PARAMETER_SH_1 = 5u;
const uint PLANE_SH_1 = 14u;
const uint PARAMETER_SH_2 = 6u;
const uint PLANE_SH_2 = 23u;
const uint PARAMETER_SH_3 = 7u;
const uint PLANE_SH_3 = 38u;

// Optional ones: bit of OPTIONAL and first plane in the buffer `optional`; first plane of all in moments and gradients. `has`: a
// variable with the value of OPTIONAL (naga reads no operations on specialisation constants).
const uint PLANE_OPTIONAL = 59u;
const uint PARAMETER_LIFESPAN = 8u;
const uint HAS_LIFESPAN = 1u;
#define OPTIONAL_LIFESPAN(has) (0u)
const uint PARAMETER_SMOOTHING = 9u;
const uint HAS_SMOOTHING = 2u;
#define OPTIONAL_SMOOTHING(has) (0u + (((has) & 1u) != 0u ? 2u : 0u))

#endif
