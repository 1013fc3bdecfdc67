precision highp float;
precision highp int;
precision highp sampler2D;
precision highp sampler3D;
precision highp sampler2DArray;
precision highp isampler2DArray;
precision highp usampler2DArray;
precision highp usampler2D;
const float pi = 3.141592653589793;
