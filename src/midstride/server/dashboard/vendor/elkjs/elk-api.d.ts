// Midstride's, not elkjs's: elk-api.js defines a global, and is not checked (tools/dashboard/tsconfig.json).
export {};
